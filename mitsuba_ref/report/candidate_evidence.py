"""What the page is told where somebody's ray caster was judged in the place of ours."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from caster.geometry.packing import Packed
from caster.rendering.images import Aovs
from caster.scene.model import Scene
from mitsuba_ref.judge.candidate_judge import CandidateJudge, CandidateJudgement
from mitsuba_ref.judge.candidate_reasons import WHY, reason
from mitsuba_ref.judge.diagnosis import Diagnosis
from mitsuba_ref.report.candidate_images import candidate_aovs
from mitsuba_ref.report.html.evidence import LayerBound


@dataclass(frozen=True)
class SeenOfCandidate:
    """mitsuba_ref.report.html.evidence.Evidence of a judge of a candidate."""

    judge: CandidateJudge
    judgement: CandidateJudgement
    diagnosis: Diagnosis

    @property
    def scene(self) -> Scene:
        return self.judge.scene

    @property
    def packed(self) -> Packed:
        return self.judge.model.packed

    @cached_property
    def ours(self) -> Aovs:
        return candidate_aovs(self.judge)

    @property
    def reference(self) -> Aovs:
        return self.judge.reference

    @property
    def always(self) -> Mapping[str, str]:
        return WHY

    def why(self, row: int) -> str:
        return reason(self.judge, self.judgement, self._said, row)

    def bound(self, name: str) -> LayerBound:
        """Of the candidate's arithmetic at the surface that the reference names: what it is judged by."""
        judge, mine = self.judge, self.judge.mine
        both = judge.answer.hit & judge.witness.hit
        if name == "normal":
            return LayerBound(own=np.where(both, mine.n_error, 0.0))
        length = np.linalg.norm(judge.d, axis=1)
        return LayerBound(own=np.where(both, (mine.t_error + judge.answer.t_rounding) * length, 0.0))

    def ids(self) -> Mapping[str, np.ndarray]:
        """The reference's alone: a candidate names no shape."""
        shape, number = self.judge.witness.shape_id, self.packed.index_in_shape
        return {"shape_reference": shape, "prim_reference": number(self.judge.prim)}

    def t(self) -> tuple[np.ndarray, np.ndarray]:
        """What a function returned, to the bit."""
        return self.judge.answer.t, self.judge.witness.t

    @cached_property
    def _said(self) -> Mapping[int, str]:
        return {int(row): what for what, rows in self.diagnosis.said.items() for row in rows}
