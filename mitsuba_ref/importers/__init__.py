"""Scene files of others -> scenes of ours: Mitsuba's XML here, MIT 6.837's text in caster.classroom.

xml_nodes -> expanding (defaults, includes, references) -> sensors, shapes, materials, emitters -> importing.
"""
