"""Making XML, and checking it against published schemas that a laboratory keeps in a folder of its own.

Nothing is fetched.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from metrosep.core.errors import UnsupportedFeatureError, WriteError

_ROOTS = {"dcc": "dcc*.xsd", "qif": "QIFDocument.xsd"}
_MOST = 4
"""Faults that a message names."""


def element(space: str, name: str, *inside: Any) -> Any:
    """Return an element; a mapping holds attributes, a text the text, None is omitted."""
    made = ET.Element(f"{{{space}}}{name}")
    for item in inside:
        if isinstance(item, str):
            made.text = item
        elif isinstance(item, Mapping):
            made.attrib.update(item)
        elif item is not None:
            made.append(item)
    return made


def xml_bytes(root: Any, prefixes: Mapping[str, str]) -> bytes:
    """Return a document in UTF-8 with a line for each element; prefixes are those of its namespaces."""
    for prefix, space in prefixes.items():
        ET.register_namespace(prefix, space)
    ET.indent(root, " ")
    made: bytes = ET.tostring(root, encoding="utf-8", xml_declaration=True)
    return made + b"\n"


def schema_in(folder: Path, kind: str) -> tuple[str, Any]:
    """Return the newest schema of a kind in a folder, with its name; WriteError where it cannot be used."""
    try:
        from lxml import etree
    except ImportError:
        raise UnsupportedFeatureError(
            'a schema is checked by lxml, which is not installed; install it: pip install "metrosep[dcc]"'
        ) from None
    files = sorted(folder.rglob("*.xsd")) if folder.is_dir() else []
    roots = [f for f in files if f.match(_ROOTS[kind])]
    if not roots:
        raise WriteError(f"{folder}: no {_ROOTS[kind]} in it; put the published schemas there")
    root = max(roots, key=lambda f: _version(f.name))
    parser = etree.XMLParser(no_network=True)
    parser.resolvers.add(_local(etree, files))
    try:
        return root.name, etree.XMLSchema(etree.parse(str(root), parser))
    except (etree.XMLSchemaParseError, etree.XMLSyntaxError) as exc:
        raise WriteError(
            f"{root}: the schema cannot be used ({exc}); put the schemas that it imports beside it"
        ) from None


def require_valid(made: bytes, folder: Path, kind: str) -> None:
    """Refuse XML that does not fit its schema: WriteError with the first faults and their lines."""
    name, schema = schema_in(folder, kind)
    from lxml import etree

    if not schema.validate(etree.fromstring(made, etree.XMLParser(huge_tree=True))):
        faults = [f"line {e.line}: {e.message}" for e in list(schema.error_log)[:_MOST]]
        raise WriteError(f"the {kind} does not fit {name}: {'; '.join(faults)}")


def _version(name: str) -> list[int]:
    return [int(n) for n in re.findall(r"\d+", name)]


def _plain(name: str) -> str:
    """Return the name of a schema without its version, to find what another one imports."""
    return re.sub(r"[-_.]?\d+(?:\.\d+)*", "", name.lower().removesuffix(".xsd"))


_IMPORT = re.compile(r"<(?:\w+:)?(?:import|include)\b[^>]*>")


def _local(etree: Any, files: list[Path]) -> Any:
    """Return what finds an imported schema among the files of a folder: by namespace and by what is used of it.

    Of several that define as much, the one of that name, then the newest.
    """
    texts = {f: f.read_text("utf-8", "replace") for f in files}
    spaces = {f: _attribute(t, "targetNamespace") for f, t in texts.items()}
    chosen: dict[str, Path] = {}
    for text in texts.values():
        for tag in _IMPORT.findall(text):
            url, space = _attribute(tag, "schemaLocation"), _attribute(tag, "namespace")
            prefix = re.search(rf'xmlns:(\w+)="{re.escape(space)}"', text) if space else None
            used = set(re.findall(rf'"{prefix[1]}:(\w+)"', text)) if prefix else set()
            name = _plain(url.rpartition("/")[2])
            found = [f for f in files if (spaces[f] == space if space else _plain(f.name) == name)]
            if url and found:
                chosen[url.rpartition("/")[2]] = max(
                    found,
                    key=lambda f: (
                        sum(f'name="{n}"' in texts[f] for n in used),
                        _plain(f.name) == name,
                        _version(f.name),
                    ),
                )

    class Local(etree.Resolver):  # type: ignore[misc]
        def resolve(self, url: str, _public: str | None, context: Any) -> Any:
            path = chosen.get(url.replace("\\", "/").rpartition("/")[2])
            return None if path is None else self.resolve_filename(str(path), context)

    return Local()


def _attribute(text: str, name: str) -> str:
    found = re.search(rf'\b{name}\s*=\s*"([^"]*)"', text)
    return found[1] if found else ""
