"""What commands share: parameters, progress bars."""
