"""Parts of scene files with the kind of tests/unit/coin_plugin.py."""

PINHOLE = '[camera]\ntype = "pinhole"\neye = [0.3, 0.4, 4]\nlook_at = [0, 0, 0]\n'
LAMP = '[[light]]\ntype = "point"\nposition = [2, 3, 4]\nintensity = [9, 9, 9]\n'
PLACES = ((-0.5, 0.0, 0.75), (0.5, 0.5, 0.5), (0.25, -1.0, 2.0))
COINS = "".join(f'[[shape]]\ntype = "coin"\ncenter = [{x}, 0.25, {z}]\nradius = {r}\n' for x, z, r in PLACES)
