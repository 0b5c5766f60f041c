"""Subjects of the judge: our caster, a Python function, a command, an EXR file; each gives one Answer."""
