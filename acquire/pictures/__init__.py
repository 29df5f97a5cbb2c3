"""Pictures in files: what a folder holds, one reader for every command, and the proof that pictures are a sequence."""
