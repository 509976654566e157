"""Sets: many captures from one spec, rendered as a campaign, verified, screened, split, looked at and packed."""
