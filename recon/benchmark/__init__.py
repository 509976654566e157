"""The benchmark: every chosen remover x repair x solver x integrator over captures with truth, to tables and a page."""
