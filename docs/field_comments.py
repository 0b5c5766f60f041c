"""An extension of mkdocstrings: what is behind a field in its line is its documentation."""

from typing import Any

import griffe


class FieldComments(griffe.Extension):
    def on_attribute_instance(self, *, attr: griffe.Attribute, **more: Any) -> None:
        comment = attr.source.partition("  # ")[2]
        if comment and not attr.docstring:
            attr.docstring = griffe.Docstring(comment, lineno=attr.lineno, parent=attr)

    def on_class_members(self, *, cls: griffe.Class, **more: Any) -> None:
        """Leave out what is no field and has no words."""
        for name, member in list(cls.members.items()):
            if name.isupper() or name == "type" or not (member.is_attribute or member.is_alias or member.docstring):
                del cls.members[name]
