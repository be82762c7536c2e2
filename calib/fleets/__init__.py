"""What several robots of one model say of the next one."""
