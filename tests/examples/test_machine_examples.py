"""The calibration of a five-axis machine: its data are those of its script."""


def test_data_are_made_by_their_script(made_again):
    made_again("five_axis_calibration")
