"""What an identification says: values, intervals, what determined them, physical consistency. Results only."""
