"""Image files: EXR channels and metadata, false-colour previews, PNG and TGA, atomic writes."""
