"""Scene files and images of the course MIT 6.837 (assignments 1, 2 and 4 of 2003 and 2004, 4 of 2011).

grammar, parser: text -> blocks. scene_conversion: blocks -> scene description.
course_files: file -> Scene. course_images: the images of the assignments.
"""
