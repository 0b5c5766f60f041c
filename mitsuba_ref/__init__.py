"""The judge: the same scene and the same rays given to Mitsuba 3, every pixel compared within a derived bound."""
