"""What a twin knows of its own engine: corrections of its maps, its health, its sensors, and how well."""
