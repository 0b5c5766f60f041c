"""What --help says without loading anything slow, compared with what there really is."""

import re

from caster.aovs import BY_NAME
from caster.cli.shared_arguments import AOV_NAMES, DEFAULT_AOV_LIST
from caster.rendering.images import DEFAULT_AOVS
from mitsuba_ref.cli import exr_comparison, options, scene_exchange
from mitsuba_ref.exr_compare import approval
from mitsuba_ref.reference import session
from mitsuba_ref.reference.rendering import REFERENCE_AOVS
from mitsuba_ref.subjects import subject


def test_the_aovs_that_help_names_are_those_of_the_registry():
    assert AOV_NAMES.split(", ") == list(BY_NAME)


def test_the_reference_gives_every_aov_there_is():
    assert scene_exchange.KNOWN_AOVS == list(REFERENCE_AOVS) == list(BY_NAME)


def test_both_renderers_write_the_same_channels_by_default():
    assert DEFAULT_AOV_LIST == scene_exchange.DEFAULT_AOV_LIST == ",".join(DEFAULT_AOVS)


def test_every_default_exists():
    assert set(re.split(",", DEFAULT_AOV_LIST)) <= set(BY_NAME)


def test_the_modes_of_approval_are_those_of_its_table():
    assert exr_comparison.MODES == approval.MODES


def test_a_candidate_gets_the_seconds_and_has_the_precisions_that_help_names():
    assert options.CANDIDATE_SECONDS == subject.DEFAULT_SECONDS
    assert options.REFERENCE_SECONDS == session.DEFAULT_TIMEOUT
    assert tuple(subject.PRECISIONS) == options.PRECISIONS
