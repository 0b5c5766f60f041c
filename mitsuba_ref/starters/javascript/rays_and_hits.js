// Rays in, hits out, in node without packages: {mesh}, {rays} and {hits} as files, or over stdin and stdout.
//
//     require("./rays_and_hits.js").run((v, f) => (o, d, tMin, tMax) => [t, nx, ny, nz, prim]);
//
// v: Float32Array, 3 a vertex; f: Int32Array, 3 indices a face; o, d: [x, y, z]. The inner function returns null for a miss;
// [t], or [t, nx, ny, nz], will do, the same at all hits.
const fs = require("fs");
const MISS = [Infinity, 0, 0, 0, -1];
console.log = console.error; // what libraries print from here on: stdout has hits alone

function cast(build, mesh, rayBytes) {
  const data = aligned(mesh), counts = new BigInt64Array(data, 0, 2), vertices = 3 * Number(counts[0]);
  const trace = build(
    new Float32Array(data, 16, vertices),
    new Int32Array(data, 16 + 4 * vertices, 3 * Number(counts[1])),
  );
  const rays = new Float32Array(aligned(rayBytes)), found = [];
  for (let i = 0; i < rays.length; i += 8) {
    const [ox, oy, oz, dx, dy, dz, tMin, tMax] = rays.subarray(i, i + 8);
    found.push(trace([ox, oy, oz], [dx, dy, dz], tMin, tMax) || null);
  }
  const columns = (found.find((hit) => hit) || MISS).length, hits = new Float32Array(found.length * columns);
  found.forEach((hit, i) => hits.set(hit || MISS.slice(0, columns), i * columns));
  return Buffer.from(hits.buffer);
}

const aligned = (b) => b.buffer.slice(b.byteOffset, b.byteOffset + b.length);

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

// node mine.js MESH.raw RAYS.raw HITS.raw; or node mine.js alone, for --candidate-serve
function run(build) {
  const files = process.argv.slice(2);
  if (files.length === 3) return fs.writeFileSync(files[2], cast(build, ...files.slice(0, 2).map((f) => fs.readFileSync(f))));
  for (let head; (head = read(8)); ) {
    const mesh = read(Number(head.readBigInt64LE())), rays = read(Number(read(8).readBigInt64LE()));
    const hits = cast(build, mesh, rays), length = Buffer.alloc(8);
    length.writeBigInt64LE(BigInt(hits.length));
    write(Buffer.concat([length, hits]));
  }
}

module.exports = { run };
