"""What is there while a job is planned: the workcell, its objectives and stiffness, what postures lack."""
