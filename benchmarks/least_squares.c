/* Damped least squares for one finger of four joints, compiled: what benchmarks/inverse_kinematics.py compares with.
 *
 * dq = (J'J + lambda 1)^-1 J' log(T(q)^-1 T*), which is J'(JJ' + lambda 1)^-1 log(..), to 1 um and 1 urad.
 * Joint k is placed by a rotation (row by row) and a shift, then turns about a unit axis; the tip is shifted once more.
 */
#include <math.h>

#define JOINTS 4

typedef struct {
    double turn[JOINTS][9];
    double shift[JOINTS][3];
    double axis[JOINTS][3];
    double tip[3];
} finger;

static void multiply(const double a[9], const double b[9], double out[9])
{
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            out[3 * i + j] = a[3 * i] * b[j] + a[3 * i + 1] * b[3 + j] + a[3 * i + 2] * b[6 + j];
}

static void apply(const double a[9], const double v[3], double out[3])
{
    for (int i = 0; i < 3; i++)
        out[i] = a[3 * i] * v[0] + a[3 * i + 1] * v[1] + a[3 * i + 2] * v[2];
}

static void cross(const double a[3], const double b[3], double out[3])
{
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

static void about(const double axis[3], double angle, double out[9])
{
    double c = cos(angle), s = sin(angle), d = 1.0 - c, x = axis[0], y = axis[1], z = axis[2];
    double m[9] = {c + x * x * d, x * y * d - z * s, x * z * d + y * s,
                   x * y * d + z * s, c + y * y * d, y * z * d - x * s,
                   x * z * d - y * s, y * z * d + x * s, c + z * z * d};
    for (int i = 0; i < 9; i++)
        out[i] = m[i];
}

/* The tip's place and orientation, and the Jacobian's columns (v; w) in the palm's axes. */
static void forward(const finger *f, const double q[JOINTS], double place[3], double turn[9], double jac[JOINTS][6])
{
    double r[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1}, p[3] = {0, 0, 0}, axis[JOINTS][3], origin[JOINTS][3];
    for (int k = 0; k < JOINTS; k++) {
        double step[3], placed[9], spin[9];
        apply(r, f->shift[k], step);
        for (int i = 0; i < 3; i++)
            origin[k][i] = p[i] += step[i];
        multiply(r, f->turn[k], placed);
        apply(placed, f->axis[k], axis[k]);
        about(f->axis[k], q[k], spin);
        multiply(placed, spin, r);
    }
    apply(r, f->tip, place);
    for (int i = 0; i < 3; i++)
        place[i] += p[i];
    for (int i = 0; i < 9; i++)
        turn[i] = r[i];
    for (int k = 0; k < JOINTS; k++) {
        double arm[3] = {place[0] - origin[k][0], place[1] - origin[k][1], place[2] - origin[k][2]};
        cross(axis[k], arm, jac[k]);
        for (int i = 0; i < 3; i++)
            jac[k][3 + i] = axis[k][i];
    }
}

/* log of the motion (R, p), as (v; w). */
static void motion_log(const double r[9], const double p[3], double out[6])
{
    double half[3] = {(r[7] - r[5]) / 2, (r[2] - r[6]) / 2, (r[3] - r[1]) / 2}; /* sin(angle) axis */
    double s = sqrt(half[0] * half[0] + half[1] * half[1] + half[2] * half[2]);
    double angle = atan2(s, (r[0] + r[4] + r[8] - 1) / 2), w[3], wp[3], wwp[3];
    double scale = s > 1e-9 ? angle / s : 1.0;
    for (int i = 0; i < 3; i++)
        w[i] = scale * half[i];
    double a2 = angle * angle;
    double c = a2 > 1e-8 ? (1 - angle * sin(angle) / (2 * (1 - cos(angle)))) / a2 : 1.0 / 12;
    cross(w, p, wp);
    cross(w, wp, wwp);
    for (int i = 0; i < 3; i++) {
        out[i] = p[i] - wp[i] / 2 + c * wwp[i];
        out[3 + i] = w[i];
    }
}

/* Solves a x = b in place for a symmetric positive matrix of four. */
static void solve4(double a[JOINTS][JOINTS], double b[JOINTS])
{
    for (int i = 0; i < JOINTS; i++) {
        for (int k = 0; k < i; k++)
            a[i][i] -= a[i][k] * a[i][k];
        a[i][i] = sqrt(a[i][i]);
        for (int j = i + 1; j < JOINTS; j++) {
            for (int k = 0; k < i; k++)
                a[j][i] -= a[j][k] * a[i][k];
            a[j][i] /= a[i][i];
        }
        for (int k = 0; k < i; k++)
            b[i] -= a[i][k] * b[k];
        b[i] /= a[i][i];
    }
    for (int i = JOINTS - 1; i >= 0; i--) {
        for (int k = i + 1; k < JOINTS; k++)
            b[i] -= a[k][i] * b[k];
        b[i] /= a[i][i];
    }
}

/* n targets, place and orientation row by row; the postures found go to q (n x 4). How many were reached. */
int solve_all(const finger *f, int n, const double *places, const double *turns, const double start[JOINTS],
              double tolerance, double damping, int limit, double *q)
{
    int reached = 0;
    for (int row = 0; row < n; row++, places += 3, turns += 9, q += JOINTS) {
        for (int k = 0; k < JOINTS; k++)
            q[k] = start[k];
        for (int turn = 0; turn < limit; turn++) {
            double p[3], r[9], jac[JOINTS][6], back[9], off[3], seen[3], left[9], e[6], local[JOINTS][6];
            forward(f, q, p, r, jac);
            for (int i = 0; i < 3; i++)
                for (int j = 0; j < 3; j++)
                    back[3 * i + j] = r[3 * j + i];
            for (int i = 0; i < 3; i++)
                off[i] = places[i] - p[i];
            apply(back, off, seen);
            multiply(back, turns, left);
            motion_log(left, seen, e);
            if (e[0] * e[0] + e[1] * e[1] + e[2] * e[2] < tolerance * tolerance &&
                e[3] * e[3] + e[4] * e[4] + e[5] * e[5] < tolerance * tolerance) {
                reached++;
                break;
            }
            double a[JOINTS][JOINTS], b[JOINTS];
            for (int k = 0; k < JOINTS; k++) {
                apply(back, jac[k], local[k]);
                apply(back, jac[k] + 3, local[k] + 3);
            }
            for (int i = 0; i < JOINTS; i++) {
                b[i] = 0;
                for (int d = 0; d < 6; d++)
                    b[i] += local[i][d] * e[d];
                for (int j = 0; j <= i; j++) {
                    a[i][j] = i == j ? damping : 0;
                    for (int d = 0; d < 6; d++)
                        a[i][j] += local[i][d] * local[j][d];
                }
            }
            solve4(a, b);
            for (int k = 0; k < JOINTS; k++)
                q[k] += b[k];
        }
    }
    return reached;
}
