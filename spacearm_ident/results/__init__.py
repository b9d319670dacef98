"""The files of a result folder: what is written and read back, and where each came from. No page."""
