"""The `caster` command line: application framework, exit codes, progress, arguments shared by commands."""
