"""Adversarial random scenes and rays, compared with exact arithmetic and Mitsuba; failures are shrunk."""
