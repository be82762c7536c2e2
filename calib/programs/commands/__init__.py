"""The commands that correct programs and reach goals."""
