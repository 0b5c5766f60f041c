"""Random scenes and rays that ask for trouble, held to exact arithmetic and to Mitsuba; failures made small."""
