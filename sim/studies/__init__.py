"""Studies of many flights: campaigns, the gallery, reproduced papers, goals. Only the command line
imports them."""
