// Decodes arrays from text without loss; mitsuba_ref/report/scene_record.py encodes them.

const KINDS = { f4: Float32Array, f8: Float64Array, i4: Int32Array, u1: Uint8Array };

/** {type, z, delta?, xor?} -> typed array. like: the unpacked array with which its bits were XORed. */
async function unpacked(packed, like) {
  const kind = KINDS[packed.type], size = kind.BYTES_PER_ELEMENT;
  const bytes = interleaved(await inflated(packed.z), size);
  if (packed.delta) addUp(bytes, size);
  if (packed.xor) flip(bytes, new Uint8Array(base(like, kind).buffer));
  return new kind(bytes.buffer);
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

/** Undoes the encoding of each number as its difference from the one before, modulo the size of its type. */
function addUp(bytes, size) {
  const whole = { 1: Uint8Array, 4: Uint32Array, 8: BigUint64Array }[size];
  const numbers = new whole(bytes.buffer);
  for (let i = 1; i < numbers.length; i++) numbers[i] += numbers[i - 1];
}

/** Converts numbers to floats of this kind; NaN becomes 0, since a conversion may change its bits. */
function base(like, kind) {
  const numbers = kind.from(like);
  for (let i = 0; i < numbers.length; i++) if (Number.isNaN(like[i])) numbers[i] = 0;
  return numbers;
}

function flip(bytes, others) {
  for (let i = 0; i < bytes.length; i++) bytes[i] ^= others[i];
}
