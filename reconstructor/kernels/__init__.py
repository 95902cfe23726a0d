"""The solver as one compiled loop: SBHE and Haar, in place, without a temporary."""
