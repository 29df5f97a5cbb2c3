"""Words, signs and widths."""
