"""The XML of Mitsuba scenes: elements that are written, and documents that are read."""
