"""Two plates and a rig to disparity, depth, confidence and reasons: rectify, proxy, match, flow, refine, depth."""
