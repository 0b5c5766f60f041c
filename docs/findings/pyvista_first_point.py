"""pyvista 0.49.1: `ray_trace(..., first_point=True)` returns the point with the largest x. Needs pyvista alone."""

import pyvista

cube = pyvista.Cube()  # from -0.5 to 0.5
for start, end in (((-2.0, 0.125, 0.25), (2.0, 0.125, 0.25)), ((2.0, 0.125, 0.25), (-2.0, 0.125, 0.25))):
    point, _ = cube.ray_trace(start, end, first_point=True)
    distance = abs(point[0] - start[0])
    print(f"from x {start[0]} to {end[0]}: at distance {distance}", "right" if distance == 1.5 else "WRONG: 1.5")
