"""Quality systems: proof that an installation computes correctly (`calib qualify`), certificates, and signatures."""
