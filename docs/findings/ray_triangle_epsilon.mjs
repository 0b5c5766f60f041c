// ray-triangle-intersection 1.0.3: a triangle whose determinant with the ray is below 1e-6 is not hit. Needs that package alone.
import intersect from "ray-triangle-intersection";

for (const size of [1, 1e-2, 1e-3, 1e-4]) {
  const triangle = [[0, 0, 0], [size, 0, 0], [0, size, 0]];
  console.log(size, intersect([], [size / 4, size / 4, size], [0, 0, -1], triangle) ? "hit" : "MISSED");
}
