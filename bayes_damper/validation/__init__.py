"""The tool held against others: campaigns whose cause is withheld, and speed and accuracy beside peers."""
