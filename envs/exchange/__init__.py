"""What an agent and its drives exchange: named vectors, process images, in memory or in frames."""
