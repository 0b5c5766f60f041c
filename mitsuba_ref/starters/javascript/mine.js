// A ray caster: every triangle, in double; no dependency. node mine.js MESH.raw RAYS.raw HITS.raw, or, for
// --candidate-serve, node mine.js alone: requests come over stdin, responses go to stdout.
const { run } = require("./rays_and_hits.js");
const sub = (a, b) => a.map((x, k) => x - b[k]);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [0, 1, 2].map((k) => a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3]);

run((v, f) => (o, d, tMin, tMax) => {
  let best = Infinity, hit = null;
  for (let j = 0; j < f.length / 3; j++) {
    const c = [0, 1, 2].map((a) => sub([...v.subarray(3 * f[3 * j + a], 3 * f[3 * j + a] + 3)], o));
    const side = [0, 1, 2].map((a) => dot(cross(c[a], c[(a + 1) % 3]), d));
    const n = cross(sub(c[1], c[0]), sub(c[2], c[0])), slope = dot(n, d), t = dot(n, c[0]) / slope;
    if ((side.some((s) => s < 0) && side.some((s) => s > 0)) || slope === 0) continue;
    if (!(t > tMin && t <= tMax && t < best)) continue;
    best = t;
    hit = [t, ...n.map((x) => x / Math.sqrt(dot(n, n))), j];
  }
  return hit;
});
