"""Your own controller: a Python function of time, state and belief, loaded by name and guarded."""
