"""The validation of a scene, from rays to its verdict, and verdicts as text, files, images and a page."""
