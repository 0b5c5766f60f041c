import rh from "./rays_and_hits.js";
import { Mesh, NullEngine, Ray, Scene, Vector3, VertexData } from "@babylonjs/core";

rh.run((v, f) => {
  const scene = new Scene(new NullEngine()), mesh = new Mesh("mesh", scene), data = new VertexData();
  [data.positions, data.indices] = [v, f];
  data.applyToMesh(mesh);
  return (o, d) => {
    const hit = new Ray(new Vector3(...o), new Vector3(...d)).intersectsMesh(mesh);
    return hit.hit && [hit.distance / Math.hypot(...d), ...hit.getNormal(true, false).negate().asArray(), hit.faceId];
  };
});
