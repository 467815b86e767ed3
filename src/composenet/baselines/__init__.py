"""The paper's comparison systems, behind one interface (`records`)."""
