"""Checks made once per scene, beside its pixels."""
