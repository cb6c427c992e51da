"""``python -m metrosep``."""

from metrosep.cli.main import main

if __name__ == "__main__":
    main()
