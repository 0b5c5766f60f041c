"""Import of Mitsuba XML: xml_document (elements, defaults, includes, references) -> scene_builder -> mitsuba_xml.

shapes and appearance convert elements. The text files of MIT 6.837 are in caster.classroom.
"""
