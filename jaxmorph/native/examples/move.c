/* cc -O3 -I"$(jaxmorph native)" move.c -o move -lm && ./move wing.plan */
#include <stdio.h>
#include <stdlib.h>
#define JMPLAN_IMPLEMENTATION
#include "jmplan.h"

int main(int count, char **words) {
    jm_plan *plan = jm_open(count > 1 ? words[1] : "wing.plan");
    if (jm_error(plan)) { fprintf(stderr, "%s\n", jm_error(plan)); return 1; }
    const int64_t d = jm_dimension(plan), n = jm_count(plan), m = jm_moving(plan);
    double *u = calloc((size_t)(m * d), sizeof *u), *points = malloc((size_t)(n * d) * sizeof *points);
    for (int64_t i = 0; u && i < m; i++) u[i * d + 1] = 0.1;          /* the wall goes up by 0.1 */
    if (!u || !points || jm_deform(plan, u, points)) { fprintf(stderr, "memory is short\n"); return 1; }
    for (int64_t i = 0; i < n * d; i++) printf("%.17g%c", points[i], (i + 1) % d ? ' ' : '\n');
    free(u);
    free(points);
    jm_close(plan);
    return 0;
}
