"""Images of other programs: from the network, from MCAP files and bags."""
