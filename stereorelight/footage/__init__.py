"""Files to scene-linear arrays and back: EXR, stills, sequences, colour, plates, previews."""
