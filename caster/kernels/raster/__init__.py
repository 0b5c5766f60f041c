"""Object-order casting: screen bounds of primitives, tiles of pixels, rays of a tile against primitives."""
