// Formatting of numbers: decimal and hexadecimal digits, and words for NaN and infinities.

const BITS = new DataView(new ArrayBuffer(8));

/** As Python's float.hex: every bit of a float64. */
function hex(value) {
  if (!Number.isFinite(value)) return "";
  BITS.setFloat64(0, value);
  const high = BITS.getUint32(0), low = BITS.getUint32(4);
  const sign = high >>> 31 ? "-" : "";
  const exponent = (high >>> 20) & 0x7ff;
  const digits = (high & 0xfffff).toString(16).padStart(5, "0") + low.toString(16).padStart(8, "0");
  if (value === 0) return sign + "0x0.0p+0";
  const power = exponent === 0 ? -1022 : exponent - 1023;
  return `${sign}0x${exponent === 0 ? 0 : 1}.${digits}p${power < 0 ? "" : "+"}${power}`;
}

/** The shortest decimal that is this float64 and no other; words for NaN and infinities. */
function decimal(value) {
  if (Number.isNaN(value)) return "NaN, not a number";
  if (value === Infinity) return "+infinity";
  if (value === -Infinity) return "-infinity";
  return Object.is(value, -0) ? "-0" : String(value);
}

/** Three digits, for differences, shares and legends. */
function brief(value) {
  if (Number.isNaN(value)) return "NaN";
  if (!Number.isFinite(value)) return value > 0 ? "inf" : "-inf";
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size >= 1e5 || size < 1e-3) return value.toExponential(2).replace(/\.?0+e/, "e").replace("e+", "e");
  return String(Number(value.toPrecision(3)));
}

/** The distance between float32 numbers of about this size. */
function spacing32(value) {
  BITS.setFloat32(0, value);
  const exponent = Math.max(1, (BITS.getUint32(0) >>> 23) & 0xff);
  return 2 ** (exponent - 127 - 23);
}

/** Difference in spacings of float32 at the larger of both. */
function ulps(ours, reference) {
  const apart = (ours - reference) / spacing32(Math.max(Math.abs(ours), Math.abs(reference)));
  return Number.isFinite(apart) ? apart : NaN;
}

function escaped(text) {
  const names = { "&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;", "'": "&#39;" };
  return String(text).replace(/[&<>"']/g, (c) => names[c]);
}

/** Both ends of a range, with enough digits for a twentieth of its width. */
function ends(low, high) {
  for (let digits = 3; digits < 17; digits++) {
    const [from, to] = [low, high].map((value) => Number(value.toPrecision(digits)));
    if (Math.abs(to - from - (high - low)) <= Math.abs(high - low) / 20)
      return digits === 3 ? [brief(low), brief(high)] : [from, to].map(String);
  }
  return [decimal(low), decimal(high)];
}

/** How much of a bound is used, in words. */
function times(share) {
  return share === Infinity ? "differs, and no bound allows it" : `${brief(share)}\u00d7 its bound`;
}

/** A rounded number, with the digits that its step leaves. */
function roundedTo(value, step) {
  const digits = Math.max(1, Math.min(9, Math.ceil(Math.log10(Math.abs(value) / step))));
  return brief(Number(value.toPrecision(digits)));
}

/** A count with thin groups of three. */
function grouped(count) {
  return String(count).replace(/\B(?=(\d{3})+$)/g, "\u2009");
}
