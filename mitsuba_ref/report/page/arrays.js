// Decodes arrays from text; mitsuba_ref/report/scene_record.py encodes them.

const KINDS = { f4: Float32Array, f8: Float64Array, i4: Int32Array, u1: Uint8Array, u2: Uint16Array, u4: Uint32Array };

/** {type, z} -> typed array; of an image, its codes. */
async function unpacked(packed) {
  const kind = KINDS[packed.type];
  const numbers = new kind(interleaved(await inflated(packed.z), kind.BYTES_PER_ELEMENT).buffer);
  return packed.width ? unfolded(numbers, packed) : numbers;
}

async function inflated(text) {
  const raw = atob(text), deflated = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) deflated[i] = raw.charCodeAt(i);
  const stream = new Blob([deflated]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** Puts the bytes of each number back together; in a packed array, bytes of equal weight are grouped. */
function interleaved(planes, size) {
  const count = planes.length / size, bytes = new Uint8Array(planes.length);
  for (let b = 0; b < size; b++) {
    const plane = b * count;
    for (let i = 0; i < count; i++) bytes[i * size + b] = planes[plane + i];
  }
  return bytes;
}

/** Signed codes of an image, channel by channel: 0, -1, 1, -2, ... were folded to 0, 1, 2, 3, ... */
function unfolded(folded, { width, height, plane }) {
  const codes = Int32Array.from(folded, (each) => (each >>> 1) ^ -(each & 1));
  if (!plane) return codes;
  for (let i = 0; i < codes.length; i++) if (i % width) codes[i] += codes[i - 1];
  for (let i = 0; i < codes.length; i++) if (i % (width * height) >= width) codes[i] += codes[i - width];
  return codes;
}

// What codes of images stand for.

/** Multiples of a step a channel; codes beyond the largest are NaN and infinities. */
function valuesOf(codes, steps, { largest, nan }) {
  const count = codes.length / steps.length;
  return Float64Array.from(codes, (code, i) => {
    if (code === nan) return NaN;
    return Math.abs(code) > largest ? code * Infinity : code * steps[Math.floor(i / count)];
  });
}

/** Shares of a bound, rounded up to a power of the root of 2. */
function sharesOf(codes, { entire, octaves, none }) {
  return Float64Array.from(codes, (code) => (code === none ? Infinity : code === 0 ? 0 : 2 ** ((code - entire) * (octaves / entire))));
}

/** Signed errors, powers of 2 of a unit. */
const errorsOf = (codes, unit) => Float64Array.from(codes, (code) => Math.sign(code) * unit * 2 ** (Math.abs(code) - 1) * (code !== 0));
