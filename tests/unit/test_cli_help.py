"""What --help says without loading anything slow, compared with what there really is."""

import re

from caster.aovs import BY_NAME
from caster.commands import render
from caster.rendering import DEFAULT_AOVS
from mitsuba_ref.baselines import approval
from mitsuba_ref.candidate import answer, asking
from mitsuba_ref.commands import approve, candidate_arguments
from mitsuba_ref.commands import render as reference_render
from mitsuba_ref.reference import GIVEN


def test_the_aovs_that_help_names_are_those_of_the_registry():
    assert render.AOVS.split(", ") == list(BY_NAME)


def test_the_reference_gives_every_aov_there_is():
    assert reference_render.KNOWN == list(GIVEN) == list(BY_NAME)


def test_both_renderers_write_the_same_channels_unless_told():
    assert render.DEFAULT == reference_render.DEFAULT == ",".join(DEFAULT_AOVS)


def test_every_default_exists():
    assert set(re.split(",", render.DEFAULT)) <= set(BY_NAME)


def test_the_modes_of_approval_are_those_that_it_knows():
    assert approve.MODES == approval.MODES


def test_a_candidate_gets_the_seconds_and_has_the_precisions_that_help_names():
    assert candidate_arguments.SECONDS == asking.DEFAULT_SECONDS
    assert tuple(answer.PRECISIONS) == candidate_arguments.PRECISIONS
