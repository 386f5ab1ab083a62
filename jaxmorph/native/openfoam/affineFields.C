#include "affineFields.H"
#include "forks.H"

#include "jmplan.h"

namespace Foam
{
    //- How far from affine u may be, relative to the largest of the coordinates: what rounding leaves of a rigid motion
    static const scalar ROUNDING = 1e-14;

    //- Least determinant of the second moments, over that of a ball of their size: below it the nodes lie in one plane
    static const scalar FLAT = 1e-6;

    struct worstOp
    {
        void operator()(label& x, const label& y) const { x = x || y; }
    };
}


Foam::affineFields::affineFields(const jm_plan* plan, const vectorField& wall)
:
    plan_(plan),
    d_(jm_dimension(plan)),
    wall_(wall),
    inverse_(tensor::zero),
    size_(0)
{
    if (wall_.empty())
    {
        return;
    }
    vector middle(vector::zero);
    forAll(wall_, i)
    {
        middle += wall_[i]/wall_.size();
        size_ = max(size_, mag(wall_[i]));
    }
    tensor moments(tensor::zero);
    forAll(wall_, i)
    {
        wall_[i] -= middle;
        moments += wall_[i]*wall_[i];
    }
    const scalar mean = tr(moments)/d_;
    if (d_ == 2)
    {
        moments.zz() = mean;
    }
    if (det(moments) > FLAT*mean*mean*mean)
    {
        inverse_ = inv(moments);
    }
}


bool Foam::affineFields::fit(const vectorField& u, vector& t, tensor& A) const
{
    t = vector::zero;
    scalar size = size_;
    forAll(u, i)
    {
        t += u[i]/u.size();
        size = max(size, mag(u[i]));
    }
    tensor moments(tensor::zero);
    forAll(u, i)
    {
        moments += (u[i] - t)*wall_[i];
    }
    A = moments & inverse_;
    forAll(u, i)
    {
        if (mag(u[i] - t - (A & wall_[i])) > ROUNDING*size)
        {
            return false;
        }
    }
    return true;
}


bool Foam::affineFields::solve()
{
    const label n = jm_count(plan_);
    const double* rest = jm_rest(plan_);
    labelList failed(1, label(0));
    fields_.resize(d_ + d_*d_);
    for (label f = 0; f < label(fields_.size()); f++)
    {
        // first the translations, then for each entry of A, row by row, the displacement that it gives
        const label row = f < d_ ? f : f/d_ - 1;
        std::vector<double> u(d_*wall_.size(), 0);
        forAll(wall_, i)
        {
            u[d_*i + row] = f < d_ ? 1 : wall_[i][f % d_];
        }
        std::vector<double>& field = fields_[f];
        field.resize(d_*n);
        failed[0] = failed[0] || jm_deform(plan_, u.data(), field.data());
        forAll(wall_, i)
        {
            const label node = jm_nodes(plan_)[i];
            for (label k = 0; node >= 0 && k < d_; k++)
            {
                // where a plan holds moving nodes back, as a symmetry plane does, they are not where u says
                failed[0] = failed[0] || field[d_*node + k] != rest[d_*node + k] + u[d_*i + k];
            }
        }
        for (label j = 0; j < d_*n; j++)
        {
            field[j] -= rest[j];
        }
    }
    combine(failed, worstOp());
    if (failed[0])
    {
        inverse_ = tensor::zero;
        fields_.clear();
    }
    return !failed[0];
}


bool Foam::affineFields::move(const std::vector<double>& u, std::vector<double>& points)
{
    vectorField given(wall_.size(), vector::zero);
    forAll(given, i)
    {
        for (label k = 0; k < d_; k++)
        {
            given[i][k] = u[d_*i + k];
        }
    }
    vector t;
    tensor A;
    if (inverse_ == tensor::zero || !fit(given, t, A) || (fields_.empty() && !solve()))
    {
        return false;
    }
    const double* rest = jm_rest(plan_);
    points.assign(rest, rest + d_*jm_count(plan_));
    for (label f = 0; f < label(fields_.size()); f++)
    {
        const scalar share = f < d_ ? t[f] : A[3*(f/d_ - 1) + f % d_];
        for (std::size_t j = 0; j < points.size(); j++)
        {
            points[j] += share*fields_[f][j];
        }
    }
    forAll(given, i)
    {
        const label node = jm_nodes(plan_)[i];
        for (label k = 0; node >= 0 && k < d_; k++)
        {
            points[d_*node + k] = rest[d_*node + k] + u[d_*i + k];
        }
    }
    return true;
}
