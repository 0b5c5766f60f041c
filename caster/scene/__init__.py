"""Scenes: the model of a scene, its files, lights, materials and export."""
