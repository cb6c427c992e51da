"""What may not stand in a file of the repository, and how long a module may be."""

import ast
import re

LONGEST_MODULE = 900

# Written backwards, so that this file does not hold what it looks for.
FOLDERS = "|".join(name[::-1] for name in ("toor", "krow", "emoh", "sresU"))
HOSTS = "|".join(
    re.escape(name[::-1])
    for name in (
        "gro.ipyp",
        "gro.detsohnohtyp",
        "gro.sjmpn",
        "moc.sjmpn",
        "gro.naibed",
        "lru-xedni",
    )
)
MACHINE_PATH = re.compile(rf"(?<![\w.$}}/-])/(?:{FOLDERS})/\w")
REGISTRY_HOST = re.compile(HOSTS)
ALLOWED_OPTION = "--no-emit-" + "lru-xedni"[::-1]


def test_no_path_of_a_machine_and_no_host_of_a_registry(files_to_commit):
    found = []
    for path in files_to_commit:
        content = path.read_bytes()
        if b"\0" in content[:4096]:
            continue
        for number, line in enumerate(content.decode("utf-8", "replace").splitlines(), 1):
            text = line.replace(ALLOWED_OPTION, "")
            if MACHINE_PATH.search(text) or REGISTRY_HOST.search(text):
                found.append(f"{path.name}:{number}: {line.strip()[:120]}")

    assert not found, "\n".join(found)


def test_planted_paths_and_hosts_are_found():
    work, home = "krow/"[::-1], "emoh/"[::-1]

    assert MACHINE_PATH.search(f"see {work}/main/x.py")
    assert MACHINE_PATH.search(f"'{home}/ann/x'")
    assert not MACHINE_PATH.search(f"https://example.org{work}/x")
    assert not MACHINE_PATH.search(f"docs{work}/x")
    assert REGISTRY_HOST.search("https://" + "gro.ipyp"[::-1] + "/simple")


def test_pins_are_names_and_versions_only(repository):
    lines = (repository / "constraints.txt").read_text(encoding="utf-8").splitlines()

    wrong = [line for line in lines if not re.fullmatch(r"[a-z0-9._-]+==[0-9][\w.!+]*", line)]

    assert lines
    assert not wrong


def test_citation_readme_and_release_notes_name_this_version(repository):
    from metrosep import __version__

    short = __version__.rpartition(".")[0]
    citation = (repository / "CITATION.cff").read_text(encoding="utf-8")
    readme = (repository / "README.md").read_text(encoding="utf-8")
    assert re.findall(r"^version: (.*)$", citation, re.MULTILINE) == [__version__]
    assert f"Version {short}," in readme
    assert (repository / f"docs/release-notes-{short}.md").is_file()


def trees_with(folder, *words):
    """Yield path and tree of the files that hold one of the words: to parse all takes long."""
    for path in sorted(folder.rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        if any(word in text for word in words):
            yield path, ast.parse(text)


def test_no_comparison_with_hidden_tolerance(repository):
    banned = {f"{module}.{name}" for module in ("np", "numpy") for name in ("allclose", "isclose")}
    folders = ("metrosep", "tests", "examples", "data_formats", "tools")
    found = [
        f"{path.relative_to(repository)}:{node.lineno}"
        for folder in folders
        for path, tree in trees_with(repository / folder, ".allclose", ".isclose")
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute)
        and node.attr in ("allclose", "isclose")
        and ast.unparse(node) in banned
    ]

    assert not found, "np.allclose forgives 10 nm by default: " + ", ".join(found)


def calls_of(folder, name):
    """Yield path, line and syntax tree of each call of a name; only the calls are parsed."""
    begin = re.compile(rf"\b{name}\(")
    for path in sorted(folder.rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        for match in begin.finditer(text):
            line = text.count("\n", 0, match.start()) + 1
            end = text.find(")", match.end())
            while end != -1:
                try:
                    yield path, line, ast.parse(text[match.start() : end + 1], mode="eval").body
                    break
                except SyntaxError:  # a bracket inside the call
                    end = text.find(")", end + 1) if end - match.start() < LONGEST_CALL else -1


LONGEST_CALL = 2000
"""Characters; what is no call by then is text that names one."""


def test_a_planted_call_is_found_with_its_keywords(tmp_path):
    (tmp_path / "x.py").write_text("a = 1\nf(g(1), (2, 3),\n  h=')')\n'f(' + i(1)\n")

    ((path, line, call),) = calls_of(tmp_path, "f")

    assert (path.name, line) == ("x.py", 2)
    assert [k.arg for k in call.keywords] == ["h"]


def test_assert_allclose_always_names_its_tolerance(repository):
    found = []
    for path, line, call in calls_of(repository / "tests", "assert_allclose"):
        given = {keyword.arg for keyword in call.keywords}
        if not given & {"atol", "rtol", None}:
            found.append(f"{path.relative_to(repository)}:{line}")

    assert not found, "write atol= in metres (or rtol=, for a ratio): " + ", ".join(found)


def test_approx_never_keeps_its_hidden_floor(repository):
    """Without abs= it forgives 1e-12, which is everything in a test of square nanometres."""
    found = [
        f"{path.relative_to(repository)}:{line}"
        for path, line, call in calls_of(repository / "tests", "approx")
        if "abs" not in {keyword.arg for keyword in call.keywords}
    ]

    assert not found, "write abs= (0.0 for a ratio): " + ", ".join(found)


CLOCKS = re.compile(r"\b(perf_counter|process_time|thread_time)\(")

DAMAGED = ("tests/io/", "tests/controllers/test_isg_cross.py")
"""Tests of files that must not hang the reader: there a limit of seconds is a limit of safety."""


def test_speed_is_printed_by_benchmarks_and_asserted_nowhere(repository):
    found = [
        name
        for path in sorted((repository / "tests").rglob("*.py"))
        if CLOCKS.search(path.read_text(encoding="utf-8"))
        and not (name := path.relative_to(repository).as_posix()).startswith(
            ("tests/benchmarks/", *DAMAGED)
        )
    ]
    assert not found, "count `calls`, or print the time in tests/benchmarks: " + ", ".join(found)


def test_no_module_is_longer_than_a_reader_can_hold(repository):
    lengths = {
        path.relative_to(repository).as_posix(): path.read_text(encoding="utf-8").count("\n")
        for path in (repository / "metrosep").rglob("*.py")
    }

    assert not {path: n for path, n in lengths.items() if n > LONGEST_MODULE}


def test_what_is_public_stands_once_in_the_package(modules):
    """A list in a module is a second one that nobody compares: it had missed 1,165 names."""
    public = ("metrosep/core/errors.py",)  # `metrosep.errors` is its public name
    lists = [
        path
        for path, tree in modules.items()
        if not path.endswith(("__init__.py", *public))
        and any(_assigns_all(node) for node in tree.body)
    ]

    assert not lists


def test_every_module_has_a_docstring(modules):
    assert not [path for path, tree in modules.items() if not ast.get_docstring(tree)]


def _assigns_all(node: ast.stmt) -> bool:
    targets = getattr(node, "targets", None) or [getattr(node, "target", None)]
    return any(isinstance(target, ast.Name) and target.id == "__all__" for target in targets)
