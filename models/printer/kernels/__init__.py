"""Compiled kernels of the nonlinear printers, called by `printer.py`. SI units; towers and carriages A, B, C.

Up to LANES printers are simulated at once, each in a lane of the processor's vectors. One array m holds their states
and parameters: m[row * LANES + l] is row `row` of lane l. Rows are constants, so that the compiler sees that nothing
overlaps. The loops over lanes have no branches: an effect does nothing where its parameters are zero. Lanes are
independent of each other.

The unknowns are the carriages' heights q. With s_i the joint vector of arm i, h_i = −s_i·ẑ, and −h_i (s_j × s_k)/det S
the column of J = −S⁻¹ diag(h) (paper, Eq. 12) that is carriage i's,

    Ẍ = J (q̈ + w),   w_i = |Ẋ − ẑ q̇_i|²/h_i         (J̇ q̇ = J w; Eq. 13 with its sign corrected)
    a = Ẍ + D d̈                                     the nozzle relative to the ground, d the frame displacement along D
    F = M₁ a + M₁ g ẑ − K η − B η̇ + joint friction   force of the arms on the nozzle holder (Eqs. 50-55)
    m q̈ = belt(s, ṡ) − b q̇ − friction − m g − Γ F,   s = u − q (Eqs. 32, 44); Γ = Jᵀ, or rows J_iᵀ P_i (Eq. 25)
    η̈ = −a − g ẑ − (K η + B η̇)/m₂
    M_f (d̈ + 2 ζ ω ḋ + ω² d) = −Dᵀ F

Mass along the arms lessens the kinetic energy by ½ ν Σ |Ẋ − ẑ q̇_i|² (models/vibration/delta.py). The carriages'
equations lose ν Σ R_iᵀ (Ẍ − ẑ q̈_i) = ν Σ R_iᵀ R_i q̈ + ν Σ R_iᵀ J w, with R_i = J − ẑ e_iᵀ. Both ends of an arm ride
on the frame, so that d does not enter.

With d̈ eliminated by μ = M₁/(M_f + M₁), R = I − μ D Dᵀ and ρ = 2 ζ ω ḋ + ω² d,

    F = R (M₁ J (q̈ + w) + f₀) − M₁ (1 − μ) D ρ,   f₀ = M₁ g ẑ − K η − B η̇ + joint friction,

three equations for q̈ remain. The drive (Eq. 34) is v̈ = d₀ (u_d − v) − d₂ v̇, u = v + (d₁/d₀) v̇.

Dry friction of force ℓ has a strain φ as its state. With r = q̇/v₀,

    F = ℓ tanh(r + φ),   φ̇ = κ (r − |r| φ/φ_m − r² φ)/(1 + r²)

In fast motion φ vanishes and F = ℓ tanh(q̇/v₀), odd about the reversal. Below v₀ the strain builds up over v₀/κ, ten
micrometres as in rolling guides, and holds a carriage at rest under any load up to ℓ tanh φ_m. In steady sliding F is
at least 0.93 ℓ at any speed. (Dahl's presliding, 1968, released at speed.) F is smooth, and as stiff as ℓ/v₀:
`printer.py` chooses the step accordingly. With κ = 0 nothing holds: any load creeps.

Where contacts bend over a way s₀ before they slide, at any speed, z is the state in place of φ (Dahl, 1968):

    F = ℓ z,   ż = (q̇ − |q̇| z)/s₀

Bristles relax at the rate |q̇|/s₀, which has no bound: beyond what an integration step can follow, q̇/s₀ stays there.
"""
