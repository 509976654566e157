"""From camera to Capture: `capture.yaml` beside the photographs says what is known, the rest is measured from them.

All keys; only `images` and `lights` are needed. Every file lies in the folder or below it. `gen.photos.spec` checks it, strictly.

    images:                         # one entry a light: a file, {file, exposure_s}, or a bracket of exposures
      - bracket: [{file: a1.png, exposure_s: 0.01}, {file: a2.png, exposure_s: 0.1}]
      - bracket: [{file: b1.png, exposure_s: 0.01}, {file: b2.png, exposure_s: 0.1}]
      - bracket: [{file: c1.png, exposure_s: 0.01}, {file: c2.png, exposure_s: 0.1}]
                                    # or a pattern, in natural order: images: "*.png"
                                    # or one of brackets: images: {glob: "*.png", exposures_s: [0.01, 0.1]}
    lights:                         # one of: directions, positions_mm, file (rows x y z, or name x y z), balls
      balls:
        - kind: chrome              # chrome: its highlight; matte: its shading, and the lights' intensities with it
          mask: left.png            # or circle_px: [x, y, radius], or outline: a picture; or nothing, and it is looked for
          diameter_mm: 20           # fixes how far away it is where the view is perspective
        - {kind: chrome, circle_px: [900, 400, 52], height_mm: 10}
      near: true                    # the lights' places, from several balls; left out: where the scale is known
    intensities: estimate           # or equal, or one or three numbers a light; left out: measured, else estimated
    colour: srgb                    # or linear, or {gamma: 2.2}; left out: 8-bit files are sRGB, all others linear
    dark: [{file: d1.png, exposure_s: 0.01}, {file: d2.png, exposure_s: 0.1}]   # lens covered; subtracted
    ambient: {file: room.png, exposure_s: 0.1}      # lights off; subtracted
    flat: {file: card.png, exposure_s: 0.1}         # an even card; divided
    camera:                         # perspective; as OpenCV calibrates it
      K: [[2400, 0, 959.5], [0, 2400, 539.5], [0, 0, 1]]
      distortion: [-0.12, 0.03, 0, 0, 0]
      distance_mm: 450              # to the object's middle
    mask: object.png                # white on the object; left out: mask.png where it is there, else the whole frame

A view from afar (telecentric, or a long lens) has `mm_per_pixel: 0.05` in place of `camera`. Lights' places and directions are in the
camera's frame: x right, y up, z to the viewer; places in millimetres from where the camera looks.
"""
