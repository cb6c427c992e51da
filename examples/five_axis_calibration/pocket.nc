%
(a pocket in words of the axes, A at -30 and at -45 deg)
G21 G90 G94
G0 A-30. C0.
G0 X-20. Y-15. Z40. S12000 M3
G1 Z35. F300
G1 X20. F800
G1 Y15. C90.
G1 X-20. A-45.
G1 Y-15. C180.
G0 Z60.
M5
M30
%
