"""What joints do beside what they are told: terms of their errors."""
