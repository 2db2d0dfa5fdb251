"""What is made of many flights: campaigns, the gallery, reproduced papers, goals. Only the CLI
imports it."""
