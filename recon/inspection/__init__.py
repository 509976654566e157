"""Inspection: a measured surface against the nominal one. `inspection.inspect` is the whole, `degloss recon inspect` its command."""
