"""Words, signs, widths and encodings."""
