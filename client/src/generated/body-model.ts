// Written by `python scripts/write_typescript.py` from the server's own definitions. Do not edit.

export const ARM = {
  lower_rad: [-3.141592653589793, -3.2812189937493397, -1.5707963267948966, -2.234021442552742, -1.5707963267948966, -1.413716694115407, -0.47123889803846897],
  upper_rad: [3.4557519189487724, 1.064650843716541, 1.5707963267948966, 0.0, 1.5707963267948966, 1.5707963267948966, 0.8203047484373349],
  most_turn_rad: 0.0999,
  detour_rad: 1.2,
  reached: 0.999999999,
  pole_rad: 0.006,
  swivel_step_rad: 0.08726646259971647,
  outside: 1500.0,
  stay: 1.0,
  ease: [0.006, 0.0, 0.012, 0.0, 0.006, 0.012, 0.012],
  at_ease_rad: [0.17453292519943295, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
  lift: 0.025,
  elbow_rests: [-0.25046356427719785, -0.09633214010661457, -0.9633214010661456],
  least_squares_steps: 2,
  metres_per_radian: 0.15,
  exact_rad: 1e-06,
  damping_m: 0.02,
} as const;

export const TRUNK = {
  waist_yaw_share: 0.3,
  waist_ranges_rad: [[-0.5235987755982988, 1.3089969389957472], [-0.5235987755982988, 0.5235987755982988], [-0.5235987755982988, 0.5235987755982988]],
  head_ranges_rad: [[-0.8726646259971648, 0.8726646259971648], [-0.5934119456780721, 0.5934119456780721], [-1.2217304763960306, 1.2217304763960306]],
} as const;

export const DEVICES = {
  body_from_device_q: [0.0, 0.0, 0.7071067811865475, 0.7071067811865475],
  head_centre_from_headset: [0.0, 1.3877787807814457e-17, 0.07999999999999999],
  hand_centre_from_wrist: [0.0, 0.0, -0.08],
  hand_from_wrist_q: {"left": [0.7071067811865476, 0.0, 0.0, 0.7071067811865475], "right": [0.7071067811865476, -0.0, -0.0, -0.7071067811865475]},
} as const;

export const SWITCHES = {
  same_m: 0.15,
  same_rad: 1.3089969389957472,
  max_switch_gap_s: 2.0,
  rest_radius_m: 0.02,
  fading_per_metre: 0.1,
  metres_per_radian: 0.15,
} as const;

export const PERSON = {
  prefix: "person/",
  joints: {"waist": [0, 1, 2], "head": [3, 4, 5], "right": [6, 7, 8, 9, 10, 11, 12], "left": [13, 14, 15, 16, 17, 18, 19]},
} as const;
