"""Pictures and maps in cells."""
