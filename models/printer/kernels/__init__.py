"""The nonlinear printers, compiled. SI throughout; towers and carriages A, B, C; `printer.py` is the way in.

Up to LANES printers run side by side, each in a lane of the processor's vectors. What they hold stands in one array m:
m[row * LANES + l] is row `row` of lane l, and rows are constants, so that the compiler sees that nothing overlaps. The
loops over lanes have no branches: an effect does nothing where its numbers are zero. No lane feels its neighbours.

The unknowns are the carriages' heights q. With s_i the joint vector of arm i, h_i = −s_i·ẑ, and −h_i (s_j × s_k)/det S
the column of J = −S⁻¹ diag(h) (paper, Eq. 12) that is carriage i's,

    Ẍ = J (q̈ + w),   w_i = |Ẋ − ẑ q̇_i|²/h_i         (J̇ q̇ = J w; Eq. 13 with its sign put right)
    a = Ẍ + D d̈                                     the nozzle seen from the ground, d the frame's sway along D
    F = M₁ a + M₁ g ẑ − K η − B η̇ + joint friction   what the arms must give to the nozzle holder (Eqs. 50-55)
    m q̈ = belt(s, ṡ) − b q̇ − friction − m g − Γ F,   s = u − q (Eqs. 32, 44); Γ = Jᵀ, or rows J_iᵀ P_i (Eq. 25)
    η̈ = −a − g ẑ − (K η + B η̇)/m₂
    M_f (d̈ + 2 ζ ω ḋ + ω² d) = −Dᵀ F

d̈ is eliminated by hand: with μ = M₁/(M_f + M₁), R = I − μ D Dᵀ and ρ = 2 ζ ω ḋ + ω² d

    F = R (M₁ J (q̈ + w) + f₀) − M₁ (1 − μ) D ρ,   f₀ = M₁ g ẑ − K η − B η̇ + joint friction,

so three equations for q̈ remain. The drive (Eq. 34) is v̈ = d₀ (u_d − v) − d₂ v̇, u = v + (d₁/d₀) v̇.

Dry friction of force ℓ has a memory φ of how far it has been strained. With r = q̇/v₀,

    F = ℓ tanh(r + φ),   φ̇ = κ (r − |r| φ/φ_m − r² φ)/(1 + r²)

In quick motion φ vanishes and this is ℓ tanh(q̇/v₀), odd about the reversal. Below v₀ strain builds up over v₀/κ, ten
micrometres as in rolling guides, and then holds a carriage truly at rest under any load up to ℓ tanh φ_m. Steady
sliding, however slow, feels at least 0.93 ℓ. (Dahl's presliding, 1968, that lets go at speed.) It is smooth, and as
stiff as ℓ/v₀: `printer.py` sees to the step. With κ = 0 nothing ever holds: any load creeps.
"""
