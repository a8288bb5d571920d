"""Documents of ISO/TS 15143-3 as XML or JSON.

A document is a tree of dictionaries with the standard's names: lists repeat an element, `datetime` and what
begins with `@` are attributes in XML and plain fields in JSON.
"""

import json
from typing import Any, Final
from xml.etree import ElementTree

NAMESPACE: Final = "http://standards.iso.org/iso/15143/-3"
"""Of the schema of ISO/TS 15143-3:2016."""
PAGE_COUNT: Final = 100
"""Elements of a page, as the standard's other servers have it."""

Node = dict[str, Any]


def links(path: str, page: int, page_count: int) -> list[Node]:
    """Links of a page: self, first and last, prev and next where there are any.

    Args:
        path: of the resource, without the page.
        page: this one, from 1.
        page_count: how many there are.
    """
    places = {"self": page, "first": 1, "prev": page - 1, "next": page + 1, "last": page_count}
    return [
        {"rel": rel, "href": f"{path}/{number}"}
        for rel, number in places.items()
        if 1 <= number <= page_count
    ]


def as_json(document: Node) -> bytes:
    """A document as JSON, without the name of its root."""
    return json.dumps(_plain(document), separators=(",", ":")).encode()


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {name.lstrip("@"): _plain(item) for name, item in value.items()}
    if isinstance(value, list):
        return [_plain(item) for item in value]
    return value


def as_xml(root: str, document: Node) -> bytes:
    """A document as XML in the standard's namespace."""
    element = ElementTree.Element(root, {"xmlns": NAMESPACE})
    _fill(element, document)
    return ElementTree.tostring(element, encoding="utf-8", xml_declaration=True)


def _fill(element: ElementTree.Element, node: Node) -> None:
    for name, value in node.items():
        if name == "datetime" or name.startswith("@"):
            element.set(name.lstrip("@"), str(value))
            continue
        for item in value if isinstance(value, list) else [value]:
            child = ElementTree.SubElement(element, name)
            if isinstance(item, dict):
                _fill(child, item)
            else:
                child.text = str(item)
