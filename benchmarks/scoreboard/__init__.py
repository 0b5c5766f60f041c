"""Published ray casters on this project's hard families: `make scoreboard` writes docs/findings/scoreboard.md."""
