"""What becomes of the defects: nothing, inpainting from the object's own surroundings, repair across the stack, or leaving samples out."""
