"""What users build mechanisms of."""
