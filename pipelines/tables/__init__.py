"""The papers' tables: one module per table, which draws, measures and says what it did."""
