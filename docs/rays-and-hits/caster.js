// A ray caster: every triangle, in double; no dependency. node caster.js MESH.raw RAYS.raw HITS.raw, or, for
// --candidate-serve, node caster.js alone: requests come over stdin, responses go to stdout.
const fs = require("fs");
const sub = (a, b) => a.map((x, k) => x - b[k]);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [0, 1, 2].map((k) => a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3]);
const aligned = (b) => b.buffer.slice(b.byteOffset, b.byteOffset + b.length);

function cast(data, rayData) {
  const counts = new BigInt64Array(data, 0, 2);
  const v = new Float32Array(data, 16, 3 * Number(counts[0]));
  const f = new Int32Array(data, 16 + v.byteLength, 3 * Number(counts[1]));
  const rays = new Float32Array(rayData), hits = new Float32Array((rays.length / 8) * 5);
  for (let i = 0; i < rays.length / 8; i++) {
    const o = [...rays.subarray(8 * i, 8 * i + 3)], d = [...rays.subarray(8 * i + 3, 8 * i + 6)];
    let best = Infinity, hit = [Infinity, 0, 0, 0, -1];
    for (let j = 0; j < f.length / 3; j++) {
      const c = [0, 1, 2].map((a) => sub([...v.subarray(3 * f[3 * j + a], 3 * f[3 * j + a] + 3)], o));
      const side = [0, 1, 2].map((a) => dot(cross(c[a], c[(a + 1) % 3]), d));
      const n = cross(sub(c[1], c[0]), sub(c[2], c[0])), slope = dot(n, d), t = dot(n, c[0]) / slope;
      if ((side.some((s) => s < 0) && side.some((s) => s > 0)) || slope === 0) continue;
      if (!(t > rays[8 * i + 6] && t <= rays[8 * i + 7] && t < best)) continue;
      best = t;
      hit = [t, ...n.map((x) => x / Math.sqrt(dot(n, n))), j];
    }
    hits.set(hit, 5 * i);
  }
  return Buffer.from(hits.buffer);
}

function read(length) { // so many bytes of stdin; null at its end
  const bytes = Buffer.alloc(length);
  for (let got = 0; got < length; ) {
    const more = fs.readSync(0, bytes, got, length - got, null);
    if (more === 0) return null;
    got += more;
  }
  return bytes;
}

function write(bytes) {
  for (let sent = 0; sent < bytes.length; ) sent += fs.writeSync(1, bytes, sent);
}

const files = process.argv.slice(2);
if (files.length === 3) {
  fs.writeFileSync(files[2], cast(aligned(fs.readFileSync(files[0])), aligned(fs.readFileSync(files[1]))));
} else {
  for (let head; (head = read(8)); ) {
    const mesh = read(Number(head.readBigInt64LE())), rays = read(Number(read(8).readBigInt64LE()));
    const hits = cast(aligned(mesh), aligned(rays)), length = Buffer.alloc(8);
    length.writeBigInt64LE(BigInt(hits.length));
    write(Buffer.concat([length, hits]));
  }
}
