"""Scene files and images of the course MIT 6.837 (assignments 1, 2 and 4 of 2003 and 2004, 4 of 2011).

course_files reads a file as a Scene, course_images makes the images of the assignments.
"""
