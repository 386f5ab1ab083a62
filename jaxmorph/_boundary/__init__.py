"""The boundary that a caller names: nodes, planes, pairs, walls."""
