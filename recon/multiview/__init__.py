"""Multi-view: captures of one object from several sides, each measured by photometric stereo, joined by stereo into one mesh."""
