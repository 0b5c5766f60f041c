"""Import of Mitsuba XML: scene_builder converts elements, mitsuba_xml documents; the text is parsed in scene_xml.

The text files of MIT 6.837 are in caster.classroom.
"""
