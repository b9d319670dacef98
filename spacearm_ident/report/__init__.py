"""Figures, pages and files out of result objects; nothing here knows how they were computed."""
