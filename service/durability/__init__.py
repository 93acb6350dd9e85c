"""Commands are kept before they are answered; checkpoints and when they are due."""
