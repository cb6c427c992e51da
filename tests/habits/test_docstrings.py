"""Public names are documented: every parameter, and every error that is raised on purpose."""

import ast
import enum
import inspect
import re
import textwrap
from collections.abc import Callable, Iterator

from public_names import public_objects

from metrosep.core import errors

IMPLICIT = frozenset({"self", "cls"})

# Too wide to tell a reader what to catch.
TOO_WIDE = frozenset({"Exception", "BaseException", "MetrosepError"})

# Not for a caller to catch.
INTERNAL = frozenset({"AssertionError", "NotImplementedError", "StopIteration", "SystemExit"})


def test_the_walk_finds_public_names():
    found = public_objects()

    assert "metrosep.core.runset.RunSet" in found
    assert "metrosep.core.runset.RunSet.by_feed" in found


def test_every_public_name_has_a_docstring():
    assert not [path for path, value in public_objects().items() if not inspect.getdoc(value)]


def test_every_parameter_is_documented():
    found = []
    for path, value in public_objects().items():
        if isinstance(value, property):
            continue
        missing = _signature(value) - _documented(inspect.getdoc(value) or "")
        if missing:
            found.append(f"{path}: {', '.join(sorted(missing))}")

    assert not found, "parameters without documentation:\n" + "\n".join(sorted(found))


def test_every_raised_error_is_documented():
    found = []
    for path, value in public_objects().items():
        documented = _section(inspect.getdoc(value) or "", "Raises")
        missing = {name for name in _raised(value) if not _covers(documented, name)}
        if missing:
            found.append(f"{path}: {', '.join(sorted(missing))}")

    assert not found, "errors that are not under Raises:\n" + "\n".join(sorted(found))


def test_a_planted_undocumented_error_is_found():
    def f(x):
        """Return x.

        Raises
        ------
        DataError
            Never.
        """
        if x:
            raise errors.UnitError("no unit")
        raise errors.LimitError("too much")

    documented = _section(inspect.getdoc(f) or "", "Raises")

    assert _raised(f) == {"UnitError", "LimitError"}
    assert _covers(documented, "UnitError")
    assert not _covers(documented, "LimitError")


def _signature(value: object) -> set[str]:
    function = value.__func__ if isinstance(value, classmethod | staticmethod) else value
    if inspect.isclass(function) and (
        issubclass(function, enum.Enum) or getattr(function, "_is_protocol", False)
    ):
        return set()
    is_error = inspect.isclass(function) and issubclass(function, BaseException)
    if is_error and "__init__" not in vars(function):
        return set()
    try:
        parameters = inspect.signature(function).parameters  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return set()
    return {name for name in parameters if not name.startswith("_")} - IMPLICIT


def _section(doc: str, title: str) -> set[str]:
    """Names that a numpydoc section documents: what stands before the colon, without indent."""
    match = re.search(rf"^{title}\n-+\n(.*?)(?=^\w[\w ]*\n-+\n|\Z)", doc, re.DOTALL | re.MULTILINE)
    names: set[str] = set()
    for line in (match.group(1) if match else "").splitlines():
        if line and not line[0].isspace():
            names.update(part.strip(" *`") for part in line.split(" : ")[0].split(","))
    return names


def _documented(doc: str) -> set[str]:
    sections = ("Parameters", "Other Parameters", "Attributes")
    return set().union(*(_section(doc, title) for title in sections))


def test_every_object_says_what_it_is():
    """<metrosep... object at 0x7f> helps nobody; what is abstract or a protocol has no objects."""
    bare = [
        path
        for path, value in public_objects().items()
        if inspect.isclass(value)
        and value.__repr__ is object.__repr__
        and not (inspect.isabstract(value) or getattr(value, "_is_protocol", False))
        and not any(issubclass(other, value) for other in _classes() if other is not value)
    ]
    assert not bare, bare


def _classes() -> list[type]:
    return [value for value in public_objects().values() if inspect.isclass(value)]


def _raised(value: object) -> set[str]:
    """Errors that a function, or a class on construction, raises in its own lines."""
    names: set[str] = set()
    for function in _code_of(value):
        tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
        for node in ast.walk(tree):
            if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
                name = ast.unparse(node.exc.func).rsplit(".", 1)[-1]
                if name[:1].isupper():
                    names.add(name)
    return names - INTERNAL


def _code_of(value: object) -> Iterator[Callable[..., object]]:
    if inspect.isclass(value):
        for name in ("__init__", "__post_init__"):
            function = vars(value).get(name)
            # A dataclass or a protocol gets its __init__ from elsewhere.
            own_file = inspect.getsourcefile(value)
            if inspect.isfunction(function) and inspect.getsourcefile(function) == own_file:
                yield function
    elif isinstance(value, property):
        if value.fget is not None:
            yield value.fget
    elif isinstance(value, classmethod | staticmethod):
        yield value.__func__
    elif inspect.isfunction(value):
        yield inspect.unwrap(value)


def _covers(documented: set[str], name: str) -> bool:
    raised = getattr(errors, name, None)
    bases = {name} if raised is None else {base.__name__ for base in raised.__mro__}
    return bool(documented & (bases - TOO_WIDE | {name}))
