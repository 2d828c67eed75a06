/* e**x is `exp`. The others as the equations use them. */

/* The larger of a and b. */
static inline double maximum(double a, double b)
{
    return a > b ? a : b;
}

/* The smaller of a and b. */
static inline double minimum(double a, double b)
{
    return a < b ? a : b;
}

/* a where the condition holds, b elsewhere. */
static inline double where(int condition, double a, double b)
{
    return condition ? a : b;
}

/* Square root of max(x, 0). */
static inline double root(double x)
{
    return x > 0.0 ? sqrt(x) : 0.0;
}

/* max(x, 0)**exponent; 0 for x <= 0. */
static inline double positive_power(double x, double exponent)
{
    return x > 0.0 ? pow(x, exponent) : 0.0;
}

/* The constants with another pressure [Pa] in place of p_amb: before the compressor or behind the turbine. */
static inline Constants with_ambient_pressure(Constants c, double pressure)
{
    c.p_amb = pressure;
    return c;
}

/* The constants with another intake manifold temperature [K] and compensation factor of the cycle [-]. */
static inline Constants with_charge(Constants c, double T_im, double eta_sc)
{
    c.T_im = T_im;
    c.eta_sc = eta_sc;
    return c;
}
