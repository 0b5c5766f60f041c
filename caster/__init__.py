"""A standalone ray caster: scenes in, depth, normals and shading out."""
