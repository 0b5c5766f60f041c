"""Where the results of long work are to go."""

import sys


def check_report(json: str | None, folder: str | None) -> None:
    """Raise OutputError now, and not after all the work; say what will be missing.

    json: a file, or - for standard output.
    """
    from caster.whole_files import check_folder, check_writable
    from mitsuba_ref.stress.plot import MissingPlots, check_available

    if json and json != "-":
        check_writable(json)
    if folder:
        check_folder(folder)
        try:
            check_available()
        except MissingPlots as missing:
            print(missing, file=sys.stderr)
