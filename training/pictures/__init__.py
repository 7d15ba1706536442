"""Pictures of runs: scopes, episodes, heat maps, homing diagrams, videos."""
