"""What an MJCF says of its joints and actuators, read without an engine."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

Attributes = dict[str, dict[str, str]]


class Mjcf:
    """The attributes of the joints and of the actuators of an MJCF by name, defaults included.

    What cannot be read has none: whatever is wrong is said where the model is compiled.
    """

    def __init__(self, model: str | Path) -> None:
        self.joints: Attributes = {}
        self.motors: Attributes = {}
        self._defaults: dict[tuple[str, str], dict[str, str]] = {}
        try:
            text = model.read_text("utf-8") if isinstance(model, Path) else model
            root = ElementTree.fromstring(text)
            if isinstance(model, Path):
                for place in [*root.iter()]:
                    for one in place.findall("include"):
                        place.extend(
                            ElementTree.parse(model.parent / one.get("file", "")).getroot()
                        )
        except (OSError, ValueError, ElementTree.ParseError):
            return
        for one in root.findall("default"):
            self._learn(one, "main")
        for one in root.findall("worldbody"):
            self._visit(one, "main")
        for one in root.findall("actuator/*"):
            general = self._whole(one, "main", "general")
            self.motors[one.get("name", "")] = {**general, **self._whole(one, "main", one.tag)}

    def _learn(self, element: ElementTree.Element, above: str) -> None:
        name = element.get("class", "main")
        inherited = {tag for at, tag in self._defaults if at == above}
        for tag in {one.tag for one in element} | inherited:
            own = element.find(tag)
            given = {} if own is None else own.attrib
            self._defaults[name, tag] = {**self._defaults.get((above, tag), {}), **given}
        for one in element.findall("default"):
            self._learn(one, name)

    def _whole(self, element: ElementTree.Element, inherited: str, tag: str) -> dict[str, str]:
        at = element.get("class", inherited)
        return {**self._defaults.get((at, tag), {}), **element.attrib}

    def _visit(self, element: ElementTree.Element, inherited: str) -> None:
        inherited = element.get("childclass", inherited)
        for joint in element.findall("joint"):
            self.joints[joint.get("name", "")] = self._whole(joint, inherited, "joint")
        for inner in (*element.findall("body"), *element.findall("frame")):
            self._visit(inner, inherited)
