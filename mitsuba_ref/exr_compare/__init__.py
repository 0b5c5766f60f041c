"""Two EXR files, pixel by pixel: `compare_exr` in compare.py is the way in."""
