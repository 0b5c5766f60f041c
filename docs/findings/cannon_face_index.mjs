// cannon-es 0.20.0: t of the nearest triangle beside the number of the last one that was tried. Needs that package alone.
import { Body, Ray, RaycastResult, Trimesh, Vec3 } from "cannon-es";

const layers = [0, -1, -2]; // one triangle each; the ray comes from above
const vertices = layers.flatMap((z) => [-1, -1, z, 2, -1, z, -1, 2, z]), faces = layers.flatMap((_, i) => [3 * i, 3 * i + 1, 3 * i + 2]);
const body = new Body({ mass: 0, shape: new Trimesh(vertices, faces) }), result = new RaycastResult();
const ray = Object.assign(new Ray(new Vec3(0, 0, 1), new Vec3(0, 0, -9)), { mode: Ray.CLOSEST, skipBackfaces: false, result });
ray.updateDirection();
ray.intersectBody(body, result);
console.log(`distance ${result.distance}, which is face 0; hitFaceIndex ${result.hitFaceIndex}`);
