import rh from "./rays_and_hits.js";
import { Body, Ray, RaycastResult, Trimesh, Vec3 } from "cannon-es";

rh.run((v, f) => {
  const body = new Body({ mass: 0, shape: new Trimesh([...v], [...f]) });
  return (o, d) => {
    const from = new Vec3(...o), far = 4 * v.reduce((most, x, k) => Math.max(most, Math.abs(x - o[k % 3])), 0), result = new RaycastResult();
    const ray = new Ray(from, from.vadd(new Vec3(...d).scale(far)));
    Object.assign(ray, { mode: Ray.CLOSEST, skipBackfaces: false, result });
    ray.updateDirection();
    ray.intersectBody(body, result);
    return result.hasHit && [result.distance / Math.hypot(...d), ...result.hitNormalWorld.toArray(), result.hitFaceIndex];
  };
});
