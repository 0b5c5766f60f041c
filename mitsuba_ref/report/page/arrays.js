// Arrays out of text, to the bit: mitsuba_ref/report/scene_record.py packs them.

const KINDS = { f4: Float32Array, f8: Float64Array, i4: Int32Array, u1: Uint8Array };

/** {type, z, delta?, xor?} -> typed array; like: what its bits were taken off from, as it was unpacked. */
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

/** Bytes of equal weight lie together; here they come back to their numbers. */
function interleaved(planes, size) {
  const count = planes.length / size, bytes = new Uint8Array(planes.length);
  for (let b = 0; b < size; b++) {
    const plane = b * count;
    for (let i = 0; i < count; i++) bytes[i * size + b] = planes[plane + i];
  }
  return bytes;
}

/** Each number is how far it is from the one before, modulo the size of its type. */
function addUp(bytes, size) {
  const whole = { 1: Uint8Array, 4: Uint32Array, 8: BigUint64Array }[size];
  const numbers = new whole(bytes.buffer);
  for (let i = 1; i < numbers.length; i++) numbers[i] += numbers[i - 1];
}

/** The same numbers as floats of this kind; 0 for NaN, whose bits a conversion may change. */
function base(like, kind) {
  const numbers = kind.from(like);
  for (let i = 0; i < numbers.length; i++) if (Number.isNaN(like[i])) numbers[i] = 0;
  return numbers;
}

function flip(bytes, others) {
  for (let i = 0; i < bytes.length; i++) bytes[i] ^= others[i];
}
