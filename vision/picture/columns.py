"""What a ray of a predicted picture is, and the columns of what the rays of a pose add up to."""

# What a ray is: meets the object, its pixel is read, at the predicted depth, hidden by something unknown, by the hand.
HIT, READ, NEAR, HIDDEN, BY_HAND = 1, 2, 4, 8, 16

# Columns of what the rays of a pose add up to: rays that met the object, those of them without a reading, seen (falling
# off with the difference), at the predicted depth, seen past, hidden, by the hand, the share of the outline across
# which the surface runs on, and beside that outline the borders within it across which it runs on to hide the object;
# the shares of the outline where what agrees ends in a step of depth, and beyond which nothing is read; and how far
# what agrees scatters about being off as a whole (sigmas of noise and bias). Last the share of the outline across which
# the surface runs on where the grid of rays ends, as along the straight side of a box: what pictures are worth was told
# without it, so that it costs a pose nothing, but it speaks against one.
HITS, UNREAD, SEEN, AGREE, PAST, BEHIND, BEHIND_HAND, OUTLINE, WITHIN, ENDS, DARK, SCATTER, SIDES = range(13)
SUMS = 13
