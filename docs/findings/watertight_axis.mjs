// watertight-ray-triangle-intersection 0.0.1: rays along -x, -y and -z are NaN: their largest axis is sought with the sign. Needs that package alone.
import intersect from "watertight-ray-triangle-intersection";

for (const sign of [1, -1])
  for (const axis of [0, 1, 2]) {
    const turned = ([x, y, z]) => [0, 1, 2].map((k) => [z, x, y][(k - axis + 3) % 3]); // the third axis becomes `axis`
    const triangle = [[-1, -1, 0], [2, -1, 0], [-1, 2, 0]].map(turned), d = turned([0, 0, sign]);
    const point = intersect([], turned([0.25, 0.25, -sign]), d, triangle);
    console.log(`d ${d}:`, point, point && point.some(Number.isNaN) ? "WRONG" : "");
  }
