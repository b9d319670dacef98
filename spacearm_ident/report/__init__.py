"""Pages and figures out of results; nothing here knows how they were computed."""
