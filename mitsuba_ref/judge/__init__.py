"""The judge: compares a subject with Mitsuba and exact arithmetic and classifies every pixel."""
