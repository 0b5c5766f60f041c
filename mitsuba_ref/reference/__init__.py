"""Mitsuba 3 as the reference: scene export, requests to a child process, variants, and images."""
