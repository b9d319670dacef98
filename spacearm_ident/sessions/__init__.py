"""One pass each, from bags to a result folder: what command, node and Python call alike."""
