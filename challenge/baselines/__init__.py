"""What a challenge compares with: tuning everything, lag and RMSE."""
