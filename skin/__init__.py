"""What a skin is: layout, taxels and their errors, measurement operator, ground truth."""
