// @babylonjs/core 9.35.0: a ray beside a triangle, by 0.0005 of its edge, hits it. Needs that package alone.
import { Ray, Vector3 } from "@babylonjs/core";

const [a, b, c] = [new Vector3(0, 0, 0), new Vector3(1, 0, 0), new Vector3(0, 1, 0)];
for (const beside of [2 ** -9, 2 ** -11, 0])
  for (const epsilon of [undefined, 0]) {
    const ray = new Ray(new Vector3(0.25, -beside, 1), new Vector3(0, 0, -1), undefined, epsilon);
    console.log(`y ${-beside}, epsilon ${epsilon ?? "as it is"}:`, ray.intersectsTriangle(a, b, c) ? "a hit" : "a miss");
  }
