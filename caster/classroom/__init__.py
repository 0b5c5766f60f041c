"""Scene files and pictures as the course MIT 6.837 has them (assignments 1, 2 and 4 of 2003 and 2004, 4 of 2011).

tokens -> parser (grammar) -> assembling (building) -> a Scene of ours; drawing draws what the course draws.
"""
