"""The studies, one file each with a `STUDY`, as `contract.listed` finds them; what they share."""
