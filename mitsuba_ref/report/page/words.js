// The words of the page: one sentence for each class of pixels, check and term.

const CLASS_WORDS = {
  agree: "Every number that is compared differs by less than the error bound of this pixel.",
  explained: `The reference has another answer than ${THE_JUDGED}, and rounding at this pixel allows both.`,
  tie: "Several primitives are hit at exactly the same distance, and each side names one of them.",
  reference_wrong: `The reference is wrong by a known defect of its own, and exact arithmetic finds ${THE_JUDGED} right.`,
  out_of_domain: "The numbers are too far apart for float32 to resolve this pixel.",
  wrong: `Exact arithmetic, or float64 at the surface that is hit, contradicts ${THE_JUDGED}, here or at other pixels with the same symptom: the scene fails.`,
  undecided: "Both sides differ, and nothing shows who is right: the scene fails.",
  unlisted: "The reference is wrong in a way that is no known defect: the scene fails, as its export may be at fault.",
};

const TERMS = [
  ["bound", "How far two right answers can be apart at this pixel: derived from its own geometry (grazing angle, distance, thin triangles) and the roundings of float32 or float64."],
  ["share of a bound", "A difference over its bound. Up to 1 it is rounding; above, somebody is wrong, or sees another surface."],
  ["nearest to its bound", "The largest share of a bound that any check of the scene uses, among pixels that agree."],
  ["adjudicated", "Decided by exact arithmetic: big integers and fractions, without rounding."],
  ["on surface", `How far the position of ${THE_JUDGED} is from the surface that it names, over its bound.`],
  ["mask", "Hit or miss: 0 where both sides agree about it."],
  ["exact", `The t of ${THE_JUDGED} against the exact one, over the bound of its own arithmetic.`],
  ["\u0394, ulp", "The difference of both sides, and the same in spacings of float32 numbers of this size."],
  ["\u2248", "A number that is stored rounded. Pixels that do not agree, and some others, are stored to the bit; the command below the class prints all digits of any pixel."],
  ["shadow", "Both sides see the same point of the same surface, and only the light there differs: whether a lamp is visible."],
];

const classWords = (name) => CLASS_WORDS[name] ?? "";

/** The classes that occur, with their meaning. */
function legendOfClasses(names) {
  return `<dl class="words">${names.map((name) =>
    `<dt><i style="background:${css(CLASS_COLORS[name])}"></i>${className(name)}</dt><dd>${escaped(classWords(name))}</dd>`).join("")}</dl>`;
}

const termsHtml = () => `<dl class="words">${TERMS.map(([term, words]) => `<dt>${term}</dt><dd>${escaped(words)}</dd>`).join("")}</dl>`;
