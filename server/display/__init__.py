"""What each browser session sees: machine views, targets, impact marks, replays."""
