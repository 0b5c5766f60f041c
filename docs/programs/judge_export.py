# Write a scene as Mitsuba XML with its meshes, and read Mitsuba XML.
import mitsuba_ref

path = mitsuba_ref.export_xml("scene.toml", folder="exported")
print(path)
imported = mitsuba_ref.import_xml(str(path), mesh_dirs=["exported"])
print(len(imported.scene.shapes), "shapes;", *imported.left_out)
