# A verdict as JSON, as `mitsuba-ref validate --json` writes it.
import json

import mitsuba_ref

verdict = mitsuba_ref.validate(["scene.toml", "builtin:needles"], size=(16, 12))
record = verdict.to_dict()
print(json.dumps(record, indent=1)[:200])
print(record["ok"], record["counts"]["agree"], [scene["name"] for scene in record["scenes"]])
