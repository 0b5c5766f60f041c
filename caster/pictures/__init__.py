"""Pictures of AOVs for people: colours, labels, PNG and TGA files.

colors -> views (an AOV as a picture, with words on what it shows) -> layout (strips and sheets) -> files.
"""
